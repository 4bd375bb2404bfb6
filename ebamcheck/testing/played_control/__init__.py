"""A control to try builds on: an OPC UA server, behind which the waiting main program runs and layers grow."""
