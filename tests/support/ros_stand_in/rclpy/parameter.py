"""Parameters: numbers, texts."""


class Parameter:
    def __init__(self, name, type_=None, value=None):
        self.name = name
        self.value = value
