"""Many runs at once: evaluation on several cores or machines, and statistics of the units of a batch."""
