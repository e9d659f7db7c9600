"""Training of the video network: the step, what is trained, its optimizer, and estimates of memory and time."""
