"""What the virtual machine truly has: for judging measurements, never for making them."""
