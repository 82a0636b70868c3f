"""A simulation in Python that hands its steps over."""

import csv
import gc
import signal
import subprocess
import sys
import threading
import time
import weakref

import numpy as np
import pytest

import gloaming

SCENE = {"field": {"range": [0, 1]}, "render": {"size": [40, 30]}, "light": {"directions": 8}}
RNG = np.random.default_rng(7)


def volume(n=12):
    return RNG.random((n, n, n), "float32")


def opened(out, **insitu):
    return gloaming.InSitu(SCENE, **{"outputs": [out / "f_{step:03}.png"], "ledger": out / "ledger.csv", "device": "cpu", "threads": 1, **insitu})


def rows(out):
    with open(out / "ledger.csv") as file:
        return list(csv.DictReader(file))


def test_frames_are_those_of_render(tmp_path):
    volumes = [volume() for _ in range(3)]
    with gloaming.InSitu(SCENE, outputs=[tmp_path / "f_{step:03}.png"], device="cpu") as lit:
        assert lit.push(volumes[0]) == "queued"
        assert lit.push(np.asfortranarray(volumes[1]), 1, 0.1) == "queued"
        assert lit.push(volumes[2].astype(">f8"), time=0.2) == "queued"
    assert lit.closed and lit.stats.lit == lit.stats.pushed == 3 and lit.stats.last_loss is None
    frames = gloaming.render(volumes, SCENE, device="cpu")
    for n, frame in enumerate(frames):
        assert (tmp_path / f"f_{n:03}.png").read_bytes() == frame.png


def test_ghost_layers_are_sliced_off_without_a_copy(tmp_path):
    values = volume(14)
    with opened(tmp_path, outputs=[tmp_path / "a_{step:03}.png"]) as lit:
        lit.push(values[1:-1, 1:-1, 1:-1])
    assert lit.stats.bytes == 12**3 * 4
    with opened(tmp_path, outputs=[tmp_path / "b_{step:03}.png"]) as lit:
        lit.push(values[1:-1, 1:-1, 1:-1].copy())
    assert (tmp_path / "a_000.png").read_bytes() == (tmp_path / "b_000.png").read_bytes()


def test_the_array_is_free_after_a_push(tmp_path):
    values = volume()
    with opened(tmp_path, queue=8) as lit:
        for step in range(4):
            lit.push(values, step)
            values[:] = np.nan
            values[:] = volume()
    assert lit.stats.lost == 0
    assert [row["holes"] for row in rows(tmp_path)] == ["0"] * 4


def test_an_array_that_is_given_away_is_kept_until_it_is_lit(tmp_path):
    class Tracked(np.ndarray):
        pass

    with opened(tmp_path) as lit:
        values = volume().view(Tracked)
        alive = weakref.ref(values)
        assert lit.push(values, give=True) == "queued"
        del values
        lit.flush()
        # What was let go without the interpreter's lock is freed when a call next has it.
        lit.push(volume())
        gc.collect()
        assert alive() is None
    assert lit.stats.lit == 2 and lit.stats.bytes == 12**3 * 4


def test_policies_drop_and_tell(tmp_path):
    with pytest.warns(gloaming.LossWarning, match="dropped"):
        with opened(tmp_path, policy="drop-newest", queue=1) as lit:
            # Pushes take microseconds, a step of this size many milliseconds.
            taken = [lit.push(volume(40), step) for step in range(12)]
    stats = lit.stats
    assert stats.dropped == taken.count("dropped") > 0
    assert stats.pushed == 12 == stats.lit + stats.dropped
    assert sum("full" in row["lost"] for row in rows(tmp_path)) == stats.dropped


def test_triggers_skip(tmp_path):
    with opened(tmp_path, every=3) as lit:
        assert [lit.push(volume(), step) for step in range(5)] == ["queued", "skipped", "skipped", "queued", "skipped"]


def test_what_is_wrong_with_a_step_is_an_error_and_the_next_goes_on(tmp_path):
    with pytest.warns(gloaming.LossWarning, match="1 of 3 steps lost"):
        with opened(tmp_path) as lit:
            lit.push(volume(), 0)
            with pytest.raises(gloaming.UnsupportedError):
                lit.push(np.zeros((3, 0, 3)), 1)
            with pytest.raises(gloaming.UnsupportedError, match="shape"):
                lit.push(np.zeros((3, 3)), 2)
            lit.push(volume(16), 3)
    assert lit.stats.lit == 2


def test_settings_are_checked(tmp_path):
    with pytest.raises(gloaming.SceneError, match="policy"):
        opened(tmp_path, polcy="block")
    with pytest.raises(gloaming.SceneError, match="coalesce"):
        opened(tmp_path, policy="never")
    with pytest.raises(gloaming.SceneError, match="outputs"):
        gloaming.InSitu(SCENE)
    with pytest.raises(gloaming.FormatError, match="overwrite"):
        opened(tmp_path, outputs=[tmp_path / "frame.png"])


def test_a_closed_session(tmp_path):
    lit = opened(tmp_path)
    lit.push(volume())
    assert lit.close().lit == 1 and lit.close().lit == 1
    with pytest.raises(gloaming.ClosedError):
        lit.push(volume())
    with pytest.raises(gloaming.ClosedError):
        with lit:
            pass
    assert "1 of 1 steps lit, closed" in repr(lit)


def test_an_error_of_the_simulation_comes_through_and_the_files_are_closed(tmp_path):
    with pytest.raises(ZeroDivisionError):
        with opened(tmp_path, outputs=[tmp_path / "movie.mp4"]) as lit:
            lit.push(volume())
            1 / 0
    assert lit.closed and (tmp_path / "movie.mp4").stat().st_size > 0


def test_threads_may_push_at_once(tmp_path):
    with opened(tmp_path) as lit:
        threads = [threading.Thread(target=lambda n=n: lit.push(volume(), n)) for n in range(6)]
        [thread.start() for thread in threads]
        [thread.join() for thread in threads]
    assert lit.stats.lit == 6 and sorted(int(row["step"]) for row in rows(tmp_path)) == list(range(6))


def test_other_threads_run_while_a_push_waits(tmp_path):
    ticks, done = [], threading.Event()

    def tick():
        while not done.wait(0.001):
            ticks.append(time.perf_counter())

    thread = threading.Thread(target=tick)
    thread.start()
    with opened(tmp_path, queue=1) as lit:
        begun = time.perf_counter()
        for step in range(8):
            lit.push(volume(48), step)
        lit.flush()
        took = time.perf_counter() - begun
    done.set()
    thread.join()
    during = [t for t in ticks if begun <= t <= begun + took]
    # With the lock held for whole steps there would be one or two a step.
    assert len(during) > 50 * took, (len(during), took)


def test_a_program_that_forgets_to_close_has_its_movie(tmp_path):
    program = (
        "import gloaming, numpy as np\n"
        f"lit = gloaming.InSitu('field.range=[0,1]\\n[render]\\nsize=[40,30]\\n', outputs=[{str(tmp_path / 'movie.mp4')!r}])\n"
        "lit.push(np.random.default_rng(0).random((8, 8, 8)))\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
    assert (tmp_path / "movie.mp4").stat().st_size > 0


@pytest.mark.parametrize("call", ["gloaming.render(slow, scene)", "gloaming.light(slow, scene)", "flush()", "close()", "push()"])
def test_ctrl_c_is_answered(tmp_path, call):
    # 128 directions to a tolerance of nothing take minutes.
    program = f"""
import gloaming, numpy as np, sys, threading, time, os, signal
# Who starts the tests in the background leaves them deaf to it.
signal.signal(signal.SIGINT, signal.default_int_handler)
scene = {{"render": {{"size": [40, 30]}}, "light": {{"directions": 128, "tolerance": 1e-6, "resolution": 1.0}},
         "transfer": {{"extinction": 1.0, "albedo": 0.9999}}, "field": {{"range": [0, 1]}}}}
slow = np.ones((96, 96, 96), "float32")
def flush():
    lit = gloaming.InSitu(scene, outputs=[{str(tmp_path / "f_{step}.png")!r}]); lit.push(slow)
    interrupt(); lit.flush()
def push():
    lit = gloaming.InSitu(scene, queue=1, outputs=[{str(tmp_path / "f_{step}.png")!r}]); lit.push(slow); lit.push(slow)
    interrupt()
    while True: lit.push(slow)
def close():
    lit = gloaming.InSitu(scene, outputs=[{str(tmp_path / "f_{step}.png")!r}]); lit.push(slow)
    interrupt(); lit.close()
def interrupt():
    threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
if "(slow" in {call!r}: interrupt()
try:
    {call}
except KeyboardInterrupt:
    # What goes on unheard must not keep the process.
    print("interrupted", flush=True)
    os._exit(0)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.stdout == "interrupted\n", done.stderr


def test_light_that_was_saved_makes_a_restart_warm(tmp_path):
    volumes = [volume() for _ in range(4)]

    def starts(first, **insitu):
        with opened(tmp_path, **insitu) as lit:
            for step in range(first, 4):
                lit.push(volumes[step], step)
                if step == 1:
                    lit.save_light(tmp_path / "light.h5")
                    assert (tmp_path / "f_001.png").exists()
        return [row["start"] for row in rows(tmp_path)], (tmp_path / "f_003.png").read_bytes()

    whole, frame = starts(0)
    assert whole == ["cold", "warm", "warm", "warm"]
    assert starts(2, light_state=tmp_path / "light.h5") == (["warm", "warm"], frame)
    with pytest.raises(gloaming.UnsupportedError):
        with opened(tmp_path) as lit:
            lit.save_light(tmp_path / "early.h5")


def test_a_forked_process_neither_pushes_nor_hangs(tmp_path):
    program = f"""
import gloaming, numpy as np, os, sys
lit = gloaming.InSitu("field.range = [0, 1]\\n[render]\\nsize = [40, 30]\\n", outputs=[{str(tmp_path / "f_{step}.png")!r}])
child = os.fork()
if not child:
    try:
        lit.push(np.zeros((8, 8, 8)))
    except gloaming.ClosedError:
        sys.exit(7)
    sys.exit(1)
lit.push(np.zeros((8, 8, 8)))
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), lit.close().lit)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.stdout == "7 1\n", done.stderr


def test_the_process_keeps_its_signal_handlers(tmp_path):
    before = signal.getsignal(signal.SIGINT)
    with opened(tmp_path) as lit:
        lit.push(volume())
    assert signal.getsignal(signal.SIGINT) is before
