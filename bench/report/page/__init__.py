"""Pages of HTML: parts as data, and the templates that lay them out."""
