"""What moves the damper: descriptions go in; strokes, currents, a servo actuator, a vehicle on a road come out."""
