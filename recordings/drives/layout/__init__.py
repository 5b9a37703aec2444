"""Lays out a drive: signs, roadside objects and vehicles along the road."""
