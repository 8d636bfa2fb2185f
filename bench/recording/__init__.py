"""Recording what goes between the bench and its instruments, and replaying it to their drivers."""
