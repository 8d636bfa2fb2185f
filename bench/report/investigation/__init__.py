"""Page and terminal view of an investigation."""
