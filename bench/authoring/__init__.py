"""Support for writing the bench's YAML files: kinds of file, schemas, checks, and commented templates."""
