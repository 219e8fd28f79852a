"""The compiled library: the controller in C, the virtual machine and the operators of the actuator model."""
