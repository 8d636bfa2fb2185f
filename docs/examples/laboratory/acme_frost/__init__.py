"""The Acme Frost, a chamber with a text protocol: driver and emulator for gyrobench."""
