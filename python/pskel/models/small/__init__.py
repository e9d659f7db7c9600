"""The small network that ships with the program."""
