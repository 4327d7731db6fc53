"""`ces iterate`: experiments on the rig in the loop."""
