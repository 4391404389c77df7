"""Texts of campaign files that several tests share."""

HAMMER = """
[campaign]
name = "Small"
[tool]
diameter = "80 mm"
teeth = 2
[material]
name = "steel"
Ktc = "1900 N/mm^2"
Krc = "800 N/mm^2"
Kac = "300 N/mm^2"
[channels]
time = { column = "t", unit = "s" }
force_x = { column = "Fx", unit = "N" }
acceleration_x = { column = "ax", unit = "m/s^2" }
[[measurement]]
name = "hammer"
method = "hammer"
records = [ { file = "hit.csv", excitation = "x" } ]
"""
"""One hammer measurement, a tool and a work material."""

DRIVE = """
[campaign]
name = "drive"
[channels]
time = { column = "time [s]", unit = "s" }
encoder_position_x = { column = "enc_x [m]", unit = "m" }
drive_force_x = { column = "Fd_x [N]", unit = "N" }
[[measurement]]
name = "stroke"
method = "drive"
records = [{ file = "stroke.csv" }]
"""
"""One record of an axis in motion, with the names of columns that controls use."""
