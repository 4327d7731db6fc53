"""The live view of a running observer: a process with rclpy listens, the server reads its lines and shares them."""
