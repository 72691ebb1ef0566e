# A study made file by file, of which only what is out of date is made again:
#
#   make -f cases/study.mk CASE=cases/taylor_green_demo.yaml TRAIN="100 200" MODEL=fast-m5
#
# The case decides what is trained on and what is swept; TRAIN and MODEL only name the files.
# Several full runs are made at once with -j.
CASE := cases/taylor_green_demo.yaml
TRAIN := 100 200
MODEL := fast-m5
RUNS := runs/$(basename $(notdir $(CASE)))
SPHROM := sphrom

FULL := $(TRAIN:%=$(RUNS)/fom-reynolds%.h5)
MAPPED := $(TRAIN:%=$(RUNS)/map-reynolds%.h5)
STAGE = $(SPHROM) $(1) $(CASE) --out $(RUNS) --force

$(RUNS)/sweep-$(MODEL).csv: $(RUNS)/operators.h5
	$(call STAGE,sweep)

$(RUNS)/operators.h5: $(RUNS)/psi.h5
	$(call STAGE,operators)

$(RUNS)/psi.h5: $(RUNS)/pod.h5
	$(call STAGE,fit-psi)

$(RUNS)/pod.h5: $(MAPPED)
	$(call STAGE,pod)

$(MAPPED): $(RUNS)/map-reynolds%.h5: $(RUNS)/fom-reynolds%.h5
	$(call STAGE,map) --only reynolds=$*

$(FULL): $(RUNS)/fom-reynolds%.h5: $(CASE)
	$(call STAGE,fom) --only reynolds=$*

# The first full run packs the particles that all of them start from.
$(wordlist 2,$(words $(FULL)),$(FULL)): | $(firstword $(FULL))

.DELETE_ON_ERROR:
