"""A world whose INS boots at once, for benches in real time, and their time limit."""

#: Bound against hanging, for waits that end with an event: far above what a loaded machine needs.
LIMIT_S = 120.0

QUICK_WORLD = """
world: quick
latitude_deg: 36.4
thermal:
  x: {heat_path: [0.0, -0.8, 0.6]}
  y: {heat_path: [0.6, 0.8, 0.0]}
  z: {heat_path: [0.8, 0.0, -0.6]}
ins: {boot_s: 0.2}
"""
