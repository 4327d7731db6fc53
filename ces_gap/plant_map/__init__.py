"""What a simulated force says of the damper: a map of speed and current, and the spring that it is in series with."""
