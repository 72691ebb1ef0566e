# The same study with Snakemake, on this machine or by its executors on a cluster:
#
#   snakemake -s cases/study.smk --cores 4 --config case=cases/taylor_green_demo.yaml
import os

CASE = config.get("case", "cases/taylor_green_demo.yaml")
TRAIN = str(config.get("train", "100 200")).split()
MODEL = config.get("model", "fast-m5")
SPHROM = config.get("sphrom", "sphrom")
RUNS = os.path.join("runs", os.path.splitext(os.path.basename(CASE))[0])


def stage(name, more=""):
    return f"{SPHROM} {name} {CASE} --out {RUNS} --force --quiet {more}"


rule all:
    input: f"{RUNS}/sweep-{MODEL}.csv"

# The first full run packs the particles that all of them start from.
rule full_run:
    input:
        case=CASE,
        packed=lambda w: [] if w.value == TRAIN[0] else f"{RUNS}/fom-reynolds{TRAIN[0]}.h5",
    output: f"{RUNS}/fom-reynolds{{value}}.h5"
    shell: stage("fom", "--only reynolds={wildcards.value}")

rule mapped:
    input: f"{RUNS}/fom-reynolds{{value}}.h5"
    output: f"{RUNS}/map-reynolds{{value}}.h5"
    shell: stage("map", "--only reynolds={wildcards.value}")

rule basis:
    input: expand(f"{RUNS}/map-reynolds{{value}}.h5", value=TRAIN)
    output: f"{RUNS}/pod.h5"
    shell: stage("pod")

rule splines:
    input: f"{RUNS}/pod.h5"
    output: f"{RUNS}/psi.h5"
    shell: stage("fit-psi")

rule operators:
    input: f"{RUNS}/psi.h5"
    output: f"{RUNS}/operators.h5"
    shell: stage("operators")

rule sweep:
    input: f"{RUNS}/operators.h5"
    output: f"{RUNS}/sweep-{MODEL}.csv"
    shell: stage("sweep")
