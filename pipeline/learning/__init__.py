"""How the model files are learned: samples of drives and images, Gaussian classes, networks, evidence."""
