"""A node's shell without a network."""

from seft_msgs_py.node.clock import MACHINE


class Shell:
    """Keeps what a node publishes, as (topic, raw), refuses and fails at, in order."""

    clock = MACHINE

    def __init__(self, experiment, name):
        self.experiment, self.name = experiment, name
        self.handlers, self.services, self.sent, self.refusals, self.faults = {}, {}, [], [], []
        self.several_senders, self.matched = str, dict

    def log(self, level, text):
        """Nobody reads it."""

    report = catch_up = follow = lambda self, what: None

    def publisher(self, topic):
        return lambda raw: self.sent.append((topic, raw))

    def subscribe(self, topic, handler, **_):
        self.handlers[topic.name] = handler

    def serve(self, service, answer):
        self.services[service] = answer

    def refuse(self, reason):
        self.refusals.append(reason)

    def attempt(self, what, call, *arguments):
        try:
            return call(*arguments)
        except KeyError as error:
            self.faults.append(error)
            return None
