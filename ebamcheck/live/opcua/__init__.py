"""The second door of a build: the control as an OPC UA server, and a control to try it on."""
