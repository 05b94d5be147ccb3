"""How does it act? Drivers of servo and sensors, and what decides when to let go."""
