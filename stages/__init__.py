"""The steps from an image to a sign, one generator stage a file; numerics beside them."""
