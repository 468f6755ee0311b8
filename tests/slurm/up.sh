#!/usr/bin/env bash
# Starts a Slurm of one node on this machine, as root and without systemd: `tests/slurm/up.sh [FOLDER]`. May be repeated.
# Needs: apt-get install -y --no-install-recommends slurm-wlm slurmctld slurmd slurm-client munge
set -euo pipefail

folder=$(realpath -m "${1:-.slurm}")
host=$(hostname -s)
memory=$(( $(awk '/MemTotal/ { print $2 }' /proc/meminfo) / 1024 * 8 / 10 ))
mkdir -p "$folder"/{state,spool,log,run}

# munge insists on these owners and rights.
install -d -o munge -g munge -m 0755 /run/munge
install -d -o munge -g munge -m 0700 /var/log/munge /var/lib/munge /etc/munge
[ -s /etc/munge/munge.key ] || dd if=/dev/urandom bs=1 count=1024 of=/etc/munge/munge.key status=none
chown munge:munge /etc/munge/munge.key
chmod 400 /etc/munge/munge.key
if ! munge -n </dev/null >/dev/null 2>&1; then
    rm -f /run/munge/munge.socket.2*
    su -s /bin/sh munge -c '/usr/sbin/munged --force'
fi

# Without DefMemPerCPU, a job that names no memory takes all of the node.
cat >"$folder/slurm.conf" <<CONF
ClusterName=one
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=16817
SlurmdPort=16818
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
CryptoType=crypto/munge
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/run/slurmctld.pid
SlurmdPidFile=$folder/run/slurmd.pid
SlurmctldLogFile=$folder/log/slurmctld.log
SlurmdLogFile=$folder/log/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
DefMemPerCPU=512
SchedulerType=sched/backfill
SchedulerParameters=sched_min_interval=1,batch_sched_delay=0,sched_interval=5
MinJobAge=300
ReturnToService=2
KillWait=5
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=$memory State=UNKNOWN
PartitionName=local Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
# Some commands forget SLURM_CONF.
if [ ! -e /etc/slurm/slurm.conf ] || [ -L /etc/slurm/slurm.conf ]; then
    mkdir -p /etc/slurm
    ln -sfn "$folder/slurm.conf" /etc/slurm/slurm.conf
fi
export SLURM_CONF=$folder/slurm.conf

# A daemon that has ended may stay as a zombie, which `kill -0` takes for alive.
alive() { [ -f "$1" ] && awk '{ exit ($3 == "Z") }' "/proc/$(cat "$1")/stat" 2>/dev/null; }
alive "$folder/run/slurmctld.pid" || slurmctld -f "$SLURM_CONF"
alive "$folder/run/slurmd.pid" || slurmd -f "$SLURM_CONF"
for _ in $(seq 100); do
    sinfo --noheader --format=%T 2>/dev/null | grep -qE 'idle|mixed|allocated' && break
    sleep 0.2
done
sinfo
