"""All dwells of one temperature solved together: what they share, and what stays each one's own."""
