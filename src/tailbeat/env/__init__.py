"""What is the task? World, reward, sensors, randomisation, and the faces that libraries know."""
