"""Proof, by new measurements, of a compensation that was loaded into the INS."""
