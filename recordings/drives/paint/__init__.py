"""Procedural images of everything along the road, in linear light."""
