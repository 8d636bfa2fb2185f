"""Closing the loop: what the bias model leaves, the physical effect behind it, the error before and after."""
