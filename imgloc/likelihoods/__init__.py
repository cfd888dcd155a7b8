"""The paper's likelihood approximations, each a stack of images (theta, y, x)."""
