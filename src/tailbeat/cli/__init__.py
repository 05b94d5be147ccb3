"""The verbs of `tailbeat`: parse, call, print."""
