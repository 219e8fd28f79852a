"""Jobs from a request to a result: the application layer, for the command line and for programs alike."""
