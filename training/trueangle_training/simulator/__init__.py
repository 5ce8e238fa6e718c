"""Joints that do not exist: their errors, their calibration campaigns, their live samples. All pure functions."""
