"""The serial link to a robot: protocol, session, recording, driving, watching."""
