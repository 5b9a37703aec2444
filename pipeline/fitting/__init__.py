"""Models learned again from a user's labels: estimates from few samples, held-out figures, thresholds by a rule."""
