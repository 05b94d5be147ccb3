"""What crosses the network? Signed datagrams, the clock, the status."""
