"""Floor plans: found on an image, read, drawn, and made maps of."""
