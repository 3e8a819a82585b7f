"""The hardware that a rig node hosts: a laboratory's class, or a controller behind UDP."""
