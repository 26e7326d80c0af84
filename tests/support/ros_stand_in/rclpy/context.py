"""From `init` to `shutdown`, once."""

import os


class Context:
    def __init__(self):
        self.domain = None
        self.namespace = ""
        self._ok = False

    def init(self, args=None, *, initialize_logging=True, domain_id=None):
        if self.domain is not None:
            raise RuntimeError("Context.init() must only be called once")
        self.domain = int(os.environ.get("ROS_DOMAIN_ID") or 0) if domain_id is None else domain_id
        for rule in args or ():  # of all arguments of ROS only this one
            if rule.startswith("__ns:="):
                self.namespace = rule.removeprefix("__ns:=")
        self._ok = True

    def ok(self):
        return self._ok

    def shutdown(self):
        if self.domain is None:
            raise RuntimeError("Context must be initialized before it can be shutdown")
        self._ok = False

    def try_shutdown(self):
        self._ok = False
