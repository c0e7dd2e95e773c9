# Second program in the guest, on the host's own file system: modules, device names, the command,
# its exit status back to the host, power off.  LAB_MODULES and LAB_DIRECTORY come with it.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/tmp LANG=C.UTF-8
mkdir -p /lib/modules /dev/pts /dev/shm /run
mount -t devpts devpts /dev/pts
mount -t tmpfs -o mode=755 tmpfs /run
mount -t tmpfs -o mode=1777 tmpfs /dev/shm
mount -t tmpfs -o mode=1777,size=75% tmpfs /var/tmp
mount --bind "$LAB_MODULES" /lib/modules
if [ -d /sys/kernel/config ]; then mount -t configfs configfs /sys/kernel/config; fi
ip link set lo up 2>/dev/null || /bin/busybox ifconfig lo up
hostname lab
ln -sf /proc/self/fd /dev/fd
ln -sf fd/0 /dev/stdin
ln -sf fd/1 /dev/stdout
ln -sf fd/2 /dev/stderr
/lib/systemd/systemd-udevd --daemon >/dev/null 2>&1
touch /lab_out/started
cd "$LAB_DIRECTORY" || cd /
setsid sh /lab_out/command.sh </dev/null >/dev/ttyS1 2>&1
echo $? >/lab_out/status
dmesg >/lab_out/dmesg
sync
/bin/busybox poweroff -f
