"""pyserial URL handlers; pyserial looks for a module named after the scheme."""
