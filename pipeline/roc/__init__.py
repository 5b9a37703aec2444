"""Receiver operating characteristics of the classifiers, and thresholds chosen by a rule (report chapters 9 and 10)."""
