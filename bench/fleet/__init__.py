"""Many runs at once: their evaluation on several cores or machines, and what units of a batch share."""
