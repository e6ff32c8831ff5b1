from eal_actors import EALError, Fleet

with Fleet.load("sim") as fleet:
    try:
        fleet["roomba-1"]["Base"].send_cmd("f1", timeout_s=0.2).get()
    except TimeoutError as error:
        print(isinstance(error, EALError) and error.code)  # deadline
