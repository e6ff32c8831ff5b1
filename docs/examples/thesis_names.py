from eal_actors.classic import CHAR, INT, ISPTR, EALconnect, EALDataInfo_t, EALdisconnect

eal = EALconnect()  # or EALconnect(host, port); without $EAL_FLEET, the sample plugin of this process
sample = eal.findResource("SampleResource")
eal.timeout_s = 2.0  # seconds until each call fails; None, the default, for the fleet file's
assert eal.setValue(sample, EALDataInfo_t(INT, 42)) == 1
assert eal.setValue(sample, None) == -1
print(eal.getValue(sample).data)
text = EALDataInfo_t(CHAR, "", 10, ISPTR)  # room for ten bytes, as readComm fills it
EALdisconnect(eal)
