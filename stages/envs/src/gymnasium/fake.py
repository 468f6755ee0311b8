# A worker for tests: a game that counts, or one of the faults that a real one can have, by its id.
import json, os, struct, sys, time

order = json.loads(sys.stdin.buffer.readline())
kind = order["id"]
out = sys.stdout.buffer


def fault(at):
    if kind == f"dies-{at}":
        print("MemoryError: no room for the car", file=sys.stderr, flush=True)
        os._exit(7)
    if kind == f"hangs-{at}":
        time.sleep(1000)
    if kind == f"prints-{at}":
        out.write(b"pygame 2.5.8 (SDL 2.32) Hello from the community\n" * 3)
        out.flush()
        time.sleep(1000)


fault("early")
versions = dict(pair.split("==") for pair in @REQUIREMENTS@.split())
if kind == "old-packages":
    versions["gymnasium"] = "0.26.3"
if kind == "no-packages":
    versions["box2d"] = None
shown = {"image": {"height": 12, "width": 8, "channels": 3}} if kind == "image" else {"vector": {"len": 2}}
size = 12 * 8 * 3 if kind == "image" else 8
action = {"discrete": {"actions": 3}} if kind == "choices" else {"continuous": {"dims": 1}}
answer = {"protocol": 2 if kind == "other-protocol" else 1, "versions": versions}
answer |= {"observation": shown, "action": action}
if order["images"]:
    answer["image"] = [3, 2]
if kind == "Nonsense-v0":
    answer["refused"] = {"kind": "unknown", "message": "did you mean `Sense`?"}
text = json.dumps(answer).encode()
out.write(b"DRILGYM1" + struct.pack("<I", len(text)) + text)
out.flush()
state = [[0, 0] for _ in range(order["count"])]
while head := sys.stdin.buffer.read(16):
    operation, env, seed = struct.unpack("<BxxxIQ", head)
    reward, outcome = 0.0, 0
    if operation == ord("R"):
        state[env] = [seed % 1000, 0]
    elif operation == ord("S"):
        (value,) = struct.unpack("<f", sys.stdin.buffer.read(4))
        fault("stepping")
        if kind == "halves":
            out.write(struct.pack("<IBBxxId", 0x4D595244, operation, 0, env, 1.0)[:9])
            out.flush()
            os._exit(0)
        state[env][1] += 1
        reward = value * state[env][0] + state[env][1]
        outcome = 1 if state[env][1] == 5 + state[env][0] % 3 else 0
    out.write(struct.pack("<IBBxxId", 0x4D595244, operation, outcome, env, reward))
    if operation == ord("P"):
        out.write(bytes([200, 100, state[env][1]] * 6))
    elif kind == "image":
        out.write(bytes([state[env][1]]) * size)
    else:
        out.write(struct.pack("<ff", *state[env]))
    out.flush()
