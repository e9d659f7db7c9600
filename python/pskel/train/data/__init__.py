"""Readers of training clips: recordings, exports, and logs that are rendered."""
