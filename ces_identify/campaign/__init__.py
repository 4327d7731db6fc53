"""Many identifications: a description goes in, a row and a model for each cell come out."""
