"""Learns the models that ship from rendered drives and real images; no part of the package."""
