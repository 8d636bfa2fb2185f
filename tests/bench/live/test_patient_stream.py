import io
import threading

from gyrobench.bench.live.patient_stream import PatientStream


class Halted(io.StringIO):
    """A terminal that takes nothing until it is let go on."""

    def __init__(self):
        super().__init__()
        self.goes_on = threading.Event()

    def write(self, text):
        self.goes_on.wait(20.0)
        return super().write(text)


def test_a_halted_terminal_holds_nobody_up_and_gets_all_in_order_later():
    halted = Halted()
    stream = PatientStream(halted, lambda: None)
    for number in range(100):
        stream.write(f"{number}\n")
    assert stream.is_behind
    stream.drain(0.1)
    assert stream.is_behind
    halted.goes_on.set()
    stream.drain(20.0)
    assert not stream.is_behind
    assert halted.getvalue().split() == [str(number) for number in range(100)]


def test_a_stream_that_nobody_reads_is_told_of():
    class Gone(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    gone = threading.Event()
    stream = PatientStream(Gone(), gone.set)
    stream.write("anybody?\n")
    assert gone.wait(20.0)
    stream.write("still nobody\n")
    stream.drain(20.0)
    assert not stream.is_behind
