"""The programs on the fish: loop, safety, watchdog, drivers, log, doctor."""
