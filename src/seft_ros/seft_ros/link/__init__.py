"""The link between two hosts: measured by messages that the other host sends back."""
