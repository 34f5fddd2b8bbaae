"""Routes: collision-free motion for a block anywhere in the workspace."""
