"""Named parameters of the user's own simulator, fitted to recordings: alone, and beside an effect that it lacks."""
