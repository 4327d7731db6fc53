"""Many identifications: a description in, a row and a model for each cell out."""
