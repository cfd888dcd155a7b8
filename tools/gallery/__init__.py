"""Short scripts to copy from: each is one function, and leaves one picture; docs/ shows them."""
