"""Callback groups: which callbacks wait for which."""


class CallbackGroup:
    def __init__(self):
        self.busy = False

    def free(self):
        return True


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    def free(self):
        return not self.busy


class ReentrantCallbackGroup(CallbackGroup):
    pass
