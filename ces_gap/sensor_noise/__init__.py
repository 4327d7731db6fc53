"""The noise of the measured force, estimated from the measurement alone: what no simulation can explain."""
