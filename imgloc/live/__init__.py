"""Maps that are held ready, and a robot, or a service, that asks where a scan is from."""
