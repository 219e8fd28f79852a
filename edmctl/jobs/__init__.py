"""Jobs from an order to a result: the application layer, for the command line and for programs alike."""
