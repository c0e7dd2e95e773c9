# Second program in the guest, on the host's file system: mounts, udev, the command, its exit status
# for the host, power off.  `machine.py` sets GUEST_MODULES and GUEST_DIRECTORY.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8
mkdir -p /lib/modules /dev/pts /dev/shm /run
mount -t devpts devpts /dev/pts
mount -t tmpfs -o mode=755 tmpfs /run
mount -t tmpfs -o mode=1777 tmpfs /dev/shm
mount -t tmpfs -o mode=1777,size=75% tmpfs /var/tmp
mount --bind "$GUEST_MODULES" /lib/modules
if [ -d /sys/kernel/config ]; then mount -t configfs configfs /sys/kernel/config; fi
ip link set lo up 2>/dev/null || /bin/busybox ifconfig lo up
hostname guest
ln -sf /proc/self/fd /dev/fd
ln -sf fd/0 /dev/stdin
ln -sf fd/1 /dev/stdout
ln -sf fd/2 /dev/stderr
# Folders in RAM alone: under /tmp each new name would be looked up on the host first.
mkdir -m 1777 /run/tmp
mkdir /run/home
export TMPDIR=/run/tmp HOME=/run/home
/lib/systemd/systemd-udevd --daemon >/dev/null 2>&1
touch /guest_out/started
cd "$GUEST_DIRECTORY" || cd /
setsid sh /guest_out/command.sh </dev/null >/dev/ttyS1 2>&1
echo $? >/guest_out/status
dmesg >/guest_out/dmesg
sync
/bin/busybox poweroff -f
