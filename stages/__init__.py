"""The steps from a picture to a sign, one generator stage a file; numerics beside them."""
