"""Times of methods, answers and the command, beside plain references, C and other matchers."""
