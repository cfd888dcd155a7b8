"""Programs around imgloc's public functions; not a part of the package."""
