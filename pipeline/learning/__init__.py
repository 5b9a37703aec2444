"""How the model files are learned: samples of drives and pictures, Gaussian classes, boosted trees."""
