"""What a machine is made to do: sequences over the machine port, each returning a frozen result."""
