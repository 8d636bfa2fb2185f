"""Verification (proof that a compensation loaded into the INS works): page, text, terminal summary."""
