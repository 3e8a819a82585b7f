"""Loop shaping of the force loop: plant, controller, loop, closed loop (paper sec. 3.2)."""
