"""What runs on the fish? The loop, safety, watchdog, drivers, log, doctor."""
