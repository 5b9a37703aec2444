"""Simulated surveys: a drive made of geometry, its signs located by the stages, and the Cramér-Rao bound."""
