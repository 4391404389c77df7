"""Operating points for CAM programs."""
