"""The laboratory: from a calibration campaign to a model file, and the simulator of a joint."""
