"""Procedural images of everything beside the road, in linear light."""
