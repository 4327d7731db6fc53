"""The next experiment: effects that the recordings cannot separate go in, a recipe that does comes out."""
