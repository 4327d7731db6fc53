"""The reference controller: speed and estimated force go in, valve current comes out."""
