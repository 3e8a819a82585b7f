"""Force control: from force error to valve drive."""
