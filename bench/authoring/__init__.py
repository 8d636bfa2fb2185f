"""What a person needs who writes the bench's files: kinds of file, checks, schemas, starting files."""
