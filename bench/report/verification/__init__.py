"""Verification (proof that a compensation loaded into the INS works): its page, report section and terminal summary."""
