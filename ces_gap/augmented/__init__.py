"""The augmented simulation: simulation, correction and composition in, `augmented.json` out, and back."""
