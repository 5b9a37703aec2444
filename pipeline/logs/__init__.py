"""Whole logs: made from images, joined from parts, converted from ROS bags, described."""
