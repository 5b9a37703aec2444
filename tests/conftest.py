"""What all tests share."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("untimed", deadline=None, max_examples=50)  # a busy machine is no fault
settings.load_profile("untimed")
