"""What measures imgloc, from a checkout: see tools/README.md."""
