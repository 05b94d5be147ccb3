"""What can I type? The verbs of `tailbeat`: parse, call, print."""
