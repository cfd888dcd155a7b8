"""From images and votes to separated, refined and weighted pose hypotheses."""
