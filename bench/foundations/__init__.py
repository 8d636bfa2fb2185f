"""What the bench and the drivers both use: errors, the clock, YAML documents, files, tables and text."""
