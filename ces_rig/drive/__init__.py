"""What moves the damper: descriptions go in; strokes, currents and the quarter vehicle on a road come out."""
