"""Candidate crops that a person marks, and what the marks say of the images."""
