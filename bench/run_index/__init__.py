"""All runs of a folder or an object store: an index of what they measured, and what it says over time."""
