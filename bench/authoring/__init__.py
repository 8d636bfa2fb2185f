"""Writing the bench's YAML files: kinds of file, schemas, checks, and commented files to start from."""
