"""The emulated bench as a program of its own: started, told to people, and its station file written."""
