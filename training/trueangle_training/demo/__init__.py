"""The whole path on this machine: simulate, train, serve, and read as a PLC would, against the known truth."""
