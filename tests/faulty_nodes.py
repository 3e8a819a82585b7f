"""A node of a test in whose program a message brings a fault to light, when SIGUSR1 says so.

python -m faulty_nodes MODULE --ros-args ...
"""

import importlib
import signal
import sys

from seft_msgs_py.node.node_shell import NodeShell


def main() -> int:
    asked = []
    signal.signal(signal.SIGUSR1, lambda *_: asked.append(True))
    subscribe = NodeShell.subscribe

    def subscribe_badly(shell, topic, handler, *words, **options):
        def handle(raw, received_ns):
            if asked:
                asked.clear()
                return {}[topic.name]
            return handler(raw, received_ns)

        return subscribe(shell, topic, handle, *words, **options)

    NodeShell.subscribe = subscribe_badly
    return importlib.import_module(sys.argv.pop(1)).main()


if __name__ == "__main__":
    sys.exit(main())
