"""The page that shows a run in a browser: read only, on loopback, with nothing from outside."""
