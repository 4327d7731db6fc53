"""What is told of a running observer: streams, latencies, running cost, episodes, status."""
