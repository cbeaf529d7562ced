"""Encoders of pictures: a convolutional network that computes z, or the state, from a stack of frames."""
