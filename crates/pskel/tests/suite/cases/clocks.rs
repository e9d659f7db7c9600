//! Clocks and calibration that contradict the rest of a log.
