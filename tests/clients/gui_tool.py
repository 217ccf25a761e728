"""Runs the DroneCAN GUI Tool without a screen and uses it as a user does: its first window, the
tick at its node ID, Tools > Subscriber, a type of message, the camera.

    gui_tool.py slcan:/.../can uavcan.equipment.power.BatteryInfo [picture.png]

It prints the text of the subscriber's window as it appears there. With the name of a picture it
also saves a picture of that window after each print. It runs until Ctrl-C. It ends with exit code 1
if a step is impossible for 30 s.

It looks for what a user sees (names, tool tips), not for attributes of the tool's classes.
"""

import os
import signal
import sys
import time
import traceback

os.environ["QT_QPA_PLATFORM"] = "offscreen"

from PyQt5.QtCore import QTimer
from PyQt5.QtWidgets import (
    QAction,
    QApplication,
    QComboBox,
    QDialog,
    QMainWindow,
    QPlainTextEdit,
    QPushButton,
    QSpinBox,
)

TIMEOUT_S = 30
STEP_MS = 50
# Each type of message of the node has been heard within this time.
LISTED_S = 1.5


def window(kind, title):
    """The window that is shown with a title that begins so."""
    for shown in QApplication.topLevelWidgets():
        if isinstance(shown, kind) and shown.isVisible() and shown.windowTitle().startswith(title):
            return shown
    return None


def button(parent, words):
    """The button with this text or tool tip, if it can be pressed."""
    for found in parent.findChildren(QPushButton):
        if words in (found.text(), found.toolTip()) and found.isVisible() and found.isEnabled():
            return found
    return None


def wait(condition):
    """Steps until the condition is something; its value is that of `yield from`."""
    while not (result := condition()):
        yield
    return result


def pause(seconds):
    end = time.monotonic() + seconds
    yield from wait(lambda: time.monotonic() > end)


def user(port, data_type, picture):
    """What the user does. At each `yield` the tool runs on."""
    setup = yield from wait(lambda: window(QDialog, "Application Setup"))
    interface = next(box for box in setup.findChildren(QComboBox) if box.parent() is not setup)
    interface.setCurrentText(port)
    button(setup, "OK").click()

    main = yield from wait(lambda: window(QMainWindow, "DroneCAN GUI Tool"))
    (yield from wait(lambda: button(main, "Apply local node ID"))).click()
    actions = {action.text(): action for action in main.findChildren(QAction)}
    actions["&Subscriber"].trigger()

    subscriber = yield from wait(lambda: window(QDialog, "Subscriber"))
    subscriber.resize(680, 440)
    # Rows of text that the window keeps.
    rows = subscriber.findChild(QSpinBox)
    rows.setValue(rows.maximum())
    choice = subscriber.findChild(QComboBox)
    # The tool lists the types that it has heard. At a new one it forgets what is chosen.
    yield from wait(lambda: choice.findText(data_type) >= 0)
    yield from pause(LISTED_S)
    choice.setCurrentText(data_type)
    button(subscriber, "Begin subscription").click()

    text = subscriber.findChild(QPlainTextEdit)
    printed = ""
    while True:
        shown = text.toPlainText()
        if shown != printed:
            print(shown[len(printed) :], end="", flush=True)
            printed = shown
            if picture:
                text.verticalScrollBar().setValue(text.verticalScrollBar().maximum())
                # Ctrl-C leaves a whole one.
                subscriber.grab().save(picture + ".new", "PNG")
                os.replace(picture + ".new", picture)
        yield "shown"


class Application(QApplication):
    """The tool's application, with a timer for the user's steps."""

    steps = None

    def __init__(self, arguments):
        super().__init__(arguments)
        self.end = time.monotonic() + TIMEOUT_S
        self.timer = QTimer()
        self.timer.timeout.connect(self.step)
        self.timer.start(STEP_MS)

    def step(self):
        try:
            if next(self.steps) == "shown":
                self.end = time.monotonic() + TIMEOUT_S
            elif time.monotonic() > self.end:
                raise TimeoutError(f"no next step for {TIMEOUT_S} s")
        except Exception:
            traceback.print_exc()
            # In a slot of Qt an exception would not end the program with an exit code.
            os._exit(1)


def main():
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    port, data_type, *picture = sys.argv[1:]
    # The tool reads options of its own when it is imported.
    del sys.argv[1:]
    from dronecan_gui_tool import main as tool

    signal.signal(signal.SIGINT, signal.SIG_DFL)
    Application.steps = user(port, data_type, picture[0] if picture else None)
    tool.QApplication = Application
    tool.main()


# The tool's process that reads the port imports this file, too.
if __name__ == "__main__":
    main()
