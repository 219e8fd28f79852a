"""What a machine is made to do: sequences over the machine's interface, each returning a frozen result."""
