"""The controller's package: from CANopen frames to corrected angles in Modbus registers."""
