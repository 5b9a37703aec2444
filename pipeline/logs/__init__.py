"""Logs as wholes: made of images, joined of parts, taken from ROS bags, described."""
